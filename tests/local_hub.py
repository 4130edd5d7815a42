"""A small Hugging Face hub on this machine: what the real client asks of one, and faults that can be switched on.

Repositories, commits, tags and files are kept in memory. Large files come and go as git-lfs has it; Xet is not offered.
"""

import base64
import json
import re
import threading
from dataclasses import dataclass, field
from hashlib import sha1, sha256
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, unquote, urlsplit

LARGE = (".parquet", ".png", ".safetensors", ".mp4")
TOKEN = "hf_of_the_tests"
_REPO = r"(?P<name>[\w.-]+/[\w.-]+)"
_ROUTES = [
    ("POST", r"/api/repos/create", "create"),
    ("POST", r"/api/validate-yaml", "validate"),
    ("GET", rf"/api/(?P<kind>model|dataset)s/{_REPO}(/revision/(?P<revision>.+))?", "info"),
    ("GET", rf"/api/(?P<kind>model|dataset)s/{_REPO}/tree/(?P<revision>[^/]+)", "tree"),
    ("GET", rf"/api/(?P<kind>model|dataset)s/{_REPO}/refs", "refs"),
    ("POST", rf"/api/(?P<kind>model|dataset)s/{_REPO}/tag/(?P<revision>[^/]+)", "tag"),
    ("DELETE", rf"/api/(?P<kind>model|dataset)s/{_REPO}/tag/(?P<tag>[^/]+)", "untag"),
    ("POST", rf"/api/(?P<kind>model|dataset)s/{_REPO}/preupload/(?P<revision>[^/]+)", "preupload"),
    ("POST", rf"/api/(?P<kind>model|dataset)s/{_REPO}/commit/(?P<revision>[^/]+)", "commit"),
    ("POST", rf"/(?P<kind>datasets/)?{_REPO}\.git/info/lfs/objects/batch", "batch"),
    ("PUT", r"/lfs/(?P<oid>[0-9a-f]{64})", "store"),
    ("GET", r"/cdn/(?P<oid>[0-9a-f]{64})/(?P<path>.+)", "large"),
    ("GET", rf"/(?P<kind>datasets/)?{_REPO}/resolve/(?P<revision>[^/]+)/(?P<path>.+)", "resolve"),
]


@dataclass
class Repo:
    """A repository: each commit is all its files, the newest last."""

    private: bool
    commits: dict[str, dict[str, bytes]] = field(default_factory=dict)
    tags: dict[str, str] = field(default_factory=dict)

    def add(self, files: dict[str, bytes]) -> str:
        commit = sha1(f"{len(self.commits)}{sorted(files)}{files}".encode()).hexdigest()
        self.commits[commit] = files
        return commit

    @property
    def head(self) -> str:
        return list(self.commits)[-1]

    def find(self, revision: str | None) -> str | None:
        if revision in (None, "main"):
            return self.head
        return self.tags.get(revision) or (revision if revision in self.commits else None)


@dataclass
class Fault:
    """What is to go wrong with requests whose path holds `where`.

    `how` is an HTTP status, "drop" (the connection breaks halfway), "wrong" (other bytes, as many), "hold" (nothing
    comes after half of them) or "silent" (no answer comes at all).
    """

    where: str
    how: int | str
    code: str = ""
    times: int = 10**9
    method: str = ""


class LocalHub:
    """The hub; `asked` are the requests it got, as "METHOD path"."""

    def __init__(self):
        self.repos: dict[tuple[str, str], Repo] = {}
        self.blobs: dict[str, bytes] = {}
        self.faults: list[Fault] = []
        self.asked: list[str] = []
        self.hidden: list[str] = []  # paths that trees list in addition
        self.closed = False  # whether a token is needed
        self.held = threading.Event()  # somebody waits for the other half
        self._end = threading.Event()
        self.server = ThreadingHTTPServer(("127.0.0.1", 0), type("Handler", (_Handler,), {"hub": self}))
        self.server.daemon_threads = True
        self.address = f"http://127.0.0.1:{self.server.server_port}"
        # Large files lie on another host, which must not get to see the token.
        self.store = f"http://localhost:{self.server.server_port}"
        threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()

    def publish(self, name: str, files: dict[str, bytes], kind: str = "model") -> str:
        """Make a repository of these files, or a further commit of it; return the commit."""
        return self.repos.setdefault((kind, name), Repo(private=False)).add(dict(files))

    def sent(self) -> list[str]:
        """Hashes of the large files that were sent."""
        return [line.rpartition("/")[2] for line in self.asked if line.startswith("PUT /lfs/")]

    def fetched(self) -> list[str]:
        """Paths of the files whose bytes were asked for."""
        gets = (re.fullmatch(r"GET (/.+/resolve/[^/]+|/cdn/[^/]+)/(.+)", line) for line in self.asked)
        return [unquote(found[2]) for found in gets if found]

    def close(self):
        self._end.set()
        self.server.shutdown()
        self.server.server_close()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    hub: LocalHub

    def _handle(self):
        length = int(self.headers.get("Content-Length") or 0)
        if self.headers.get("Transfer-Encoding") == "chunked":
            self.body = b"".join(iter(self._chunk, b""))
        else:
            self.body = self.rfile.read(length)
        url = urlsplit(self.path)
        self.query = parse_qs(url.query)
        method = self.command
        self.hub.asked.append(f"{method} {url.path}")
        self.fault = None
        for fault in self.hub.faults:
            # An answer to a HEAD has no bytes with which something could go wrong.
            if method == "HEAD" and fault.how in ("drop", "wrong", "hold"):
                continue
            if fault.times > 0 and fault.where in url.path and fault.method in ("", method):
                fault.times -= 1
                self.fault = fault
                break
        if self.fault and isinstance(self.fault.how, int):
            return self._error(self.fault.how, self.fault.code)
        if self.fault and self.fault.how == "silent":
            self.close_connection = True
            self.hub._end.wait()
            return
        outside, token = url.path.startswith(("/cdn/", "/lfs/")), self.headers.get("Authorization")
        if self.hub.closed and not outside and token != f"Bearer {TOKEN}":
            return self._error(401)
        if outside and token:
            return self._error(400)
        for verb, pattern, action in _ROUTES:
            found = re.fullmatch(pattern, url.path)
            if found and verb == ("GET" if method == "HEAD" else method):
                return self._act(action, {k: unquote(v) if v else v for k, v in found.groupdict().items()})
        self._error(404)

    do_GET = do_HEAD = do_POST = do_PUT = do_DELETE = _handle

    def _chunk(self) -> bytes:
        data = self.rfile.read(int(self.rfile.readline(), 16))
        self.rfile.readline()
        return data

    def _act(self, action, given):
        if "name" in given:
            kind = "dataset" if (given.get("kind") or "").startswith("dataset") else "model"
            repo = self.hub.repos.get((kind, given["name"]))
            if repo is None:
                return self._error(404, "RepoNotFound")
            given |= {"kind": kind, "repo": repo}
            if "revision" in given and action != "tag":
                given["revision"] = repo.find(given["revision"])
                if given["revision"] is None:
                    return self._error(404, "RevisionNotFound")
        getattr(self, f"_{action}")(**given)

    def _create(self):
        asked = json.loads(self.body)
        kind, name = asked.get("type") or "model", f"{asked['organization']}/{asked['name']}"
        url = f"{self.hub.address}/{'datasets/' if kind == 'dataset' else ''}{name}"
        if (kind, name) in self.hub.repos:
            return self._json({"error": "You already created this repo", "url": url}, 409)
        private = asked.get("private") or asked.get("visibility") == "private"
        self.hub.repos[kind, name] = Repo(bool(private))
        self.hub.repos[kind, name].add({".gitattributes": b"*.parquet filter=lfs diff=lfs merge=lfs -text\n"})
        self._json({"url": url, "name": name, "id": name})

    def _validate(self):
        self._json({"errors": [], "warnings": []})

    def _info(self, kind, name, repo, revision):
        siblings = [{"rfilename": path} for path in repo.commits[revision]]
        told = {"id": name, "sha": revision, "private": repo.private, "siblings": siblings, "tags": []}
        self._json(told | {"xetEnabled": False, "downloads": 0, "likes": 0})

    def _tree(self, kind, name, repo, revision):
        files = repo.commits[revision] | {path: b"hidden" for path in self.hub.hidden}
        folders = {"/".join(parts[:n]) for path in files for parts in [path.split("/")] for n in range(1, len(parts))}
        entries = [{"type": "directory", "path": path, "oid": "0" * 40, "size": 0} for path in sorted(folders)]
        for path, data in files.items():
            entry = {"type": "file", "path": path, "size": len(data), "oid": _blob(path, data)}
            if path.endswith(LARGE):
                entry["lfs"] = {"oid": sha256(data).hexdigest(), "size": len(data), "pointerSize": len(_pointer(data))}
            entries.append(entry)
        self._json(entries)

    def _refs(self, kind, name, repo):
        tags = [{"name": tag, "ref": f"refs/tags/{tag}", "targetCommit": commit} for tag, commit in repo.tags.items()]
        branches = [{"name": "main", "ref": "refs/heads/main", "targetCommit": repo.head}]
        self._json({"branches": branches, "converts": [], "tags": tags})

    def _tag(self, kind, name, repo, revision):
        tag = json.loads(self.body)["tag"]
        if tag in repo.tags:
            return self._json({"error": "Tag already exists"}, 409)
        repo.tags[tag] = repo.find(revision)
        self._json({})

    def _untag(self, kind, name, repo, tag):
        del repo.tags[tag]
        self._json({})

    def _preupload(self, kind, name, repo, revision):
        there = repo.commits[revision]
        files = [
            {
                "path": asked["path"],
                "uploadMode": "lfs" if asked["path"].endswith(LARGE) else "regular",
                "shouldIgnore": False,
                "oid": _blob(asked["path"], there[asked["path"]]) if asked["path"] in there else None,
            }
            for asked in json.loads(self.body)["files"]
        ]
        self._json({"files": files})

    def _batch(self, kind, name, repo):
        objects = []
        for asked in json.loads(self.body)["objects"]:
            if asked["oid"] not in self.hub.blobs:
                asked["actions"] = {"upload": {"href": f"{self.hub.store}/lfs/{asked['oid']}", "header": {}}}
            objects.append(asked)
        self._json({"transfer": "basic", "objects": objects})

    def _store(self, oid):
        if sha256(self.body).hexdigest() != oid:
            return self._error(400)
        self.hub.blobs[oid] = self.body
        self._json({})

    def _commit(self, kind, name, repo, revision):
        files = dict(repo.commits[repo.head])
        for line in self.body.splitlines():
            item = json.loads(line)
            key, value = item["key"], item["value"]
            if key == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif key == "lfsFile":
                files[value["path"]] = self.hub.blobs[value["oid"]]
            elif key == "deletedFile":
                del files[value["path"]]
        commit = repo.add(files)
        self._json({"commitUrl": f"{self.hub.address}/{name}/commit/{commit}", "commitOid": commit, "success": True})

    def _resolve(self, kind, name, repo, revision, path):
        data = repo.commits[revision].get(path)
        if data is None:
            return self._error(404, "EntryNotFound", {"X-Repo-Commit": revision})
        headers = {"X-Repo-Commit": revision, "ETag": f'"{_blob(path, data)}"'}
        if not path.endswith(LARGE):
            return self._send(data, headers)
        oid = sha256(data).hexdigest()
        self.hub.blobs[oid] = data
        headers |= {
            "X-Linked-Etag": f'"{oid}"',
            "X-Linked-Size": str(len(data)),
            "Location": f"{self.hub.store}/cdn/{oid}/{path}",
        }
        self._send(b"", headers, 302)

    def _large(self, oid, path):
        self._send(self.hub.blobs[oid], {"ETag": f'"{oid}"'})

    def _json(self, value, status=200):
        self._send(json.dumps(value).encode(), {"Content-Type": "application/json"}, status)

    def _error(self, status, code="", headers=None):
        told = {"X-Error-Code": code, "X-Error-Message": f"no: {status}"} if code else {"X-Error-Message": "no"}
        self._send(json.dumps({"error": "no"}).encode(), told | (headers or {}), status)

    def _send(self, data, headers, status=200):
        whole = len(data)
        if status == 200 and (asked := re.fullmatch(r"bytes=(\d+)-", self.headers.get("Range") or "")):
            data, status = data[int(asked[1]) :], 206
            headers = headers | {"Content-Range": f"bytes {asked[1]}-{whole - 1}/{whole}"}
        how = self.fault.how if self.fault else None
        if how == "wrong":
            data = bytes(byte ^ 255 for byte in data)
        self.send_response(status)
        for name, value in ({"Accept-Ranges": "bytes", "Content-Length": str(len(data))} | headers).items():
            self.send_header(name, value)
        self.end_headers()
        if self.command == "HEAD":
            return
        if how in ("drop", "hold"):
            self.wfile.write(data[: len(data) // 2])
            if how == "hold":
                self.hub.held.set()
                self.hub._end.wait()
            self.close_connection = True
            return
        self.wfile.write(data)

    def log_message(self, *_):
        pass


def _pointer(data: bytes) -> bytes:
    lines = (
        "version https://git-lfs.github.com/spec/v1",
        f"oid sha256:{sha256(data).hexdigest()}",
        f"size {len(data)}",
    )
    return "".join(f"{line}\n" for line in lines).encode()


def _blob(path: str, data: bytes) -> str:
    content = _pointer(data) if path.endswith(LARGE) else data
    return sha1(f"blob {len(content)}\0".encode() + content).hexdigest()
