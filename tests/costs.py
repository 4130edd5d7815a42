"""What each test costs: `nox -s tests -- --costs 10` prints the ten files and the ten tests that cost most.

Seconds of processor time, child processes included, which a busy machine stretches less than the clock's. Of them:
those in which JAX traces and lowers, those in which XLA compiles, and how many programs it compiles. With an empty
`JAX_COMPILATION_CACHE_DIR` nothing is taken from an earlier run.
"""

import collections
import os

import jax
import pytest

EVENTS = {
    "/jax/core/compile/jaxpr_trace_duration": "trace",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "lower",
    "/jax/core/compile/backend_compile_duration": "compile",
}
COLUMNS = ("cpu", "trace", "lower", "compile", "programs")

_spent = collections.Counter()


def _note(event: str, seconds: float, **_) -> None:
    if event in EVENTS:
        _spent[EVENTS[event]] += seconds
        _spent["programs"] += EVENTS[event] == "compile"


def pytest_addoption(parser):
    parser.addoption("--costs", type=int, default=0, metavar="N", help="the N files and tests that cost most")


def pytest_configure(config):
    if config.option.costs:
        jax.monitoring.register_event_duration_secs_listener(_note)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    _spent.clear()
    _spent["cpu"] = -sum(os.times()[:4])
    return (yield)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_makereport(item, call):
    """The last of a test's three reports carries what all of them cost, from a worker to the one that prints."""
    if call.when == "teardown" and item.config.option.costs:
        item.user_properties.append(("costs", dict(_spent, cpu=_spent["cpu"] + sum(os.times()[:4]))))


def pytest_terminal_summary(terminalreporter, config):
    if not config.option.costs:
        return
    tests, files = {}, collections.defaultdict(collections.Counter)
    for reports in terminalreporter.stats.values():
        for report in reports:
            for name, spent in getattr(report, "user_properties", ()):
                if name == "costs" and report.when == "teardown":
                    tests[report.nodeid] = spent
                    files[report.nodeid.split("::")[0]].update(spent)
    for title, rows in (("files", files), ("tests", tests)):
        terminalreporter.section(f"{title} that cost most")
        terminalreporter.line(" ".join(f"{name:>8}" for name in COLUMNS))
        largest = sorted(rows.items(), key=lambda row: -row[1]["cpu"])[: config.option.costs]
        total = sum(map(collections.Counter, rows.values()), collections.Counter())
        for name, spent in [("all of them", total), *largest]:
            terminalreporter.line(" ".join(f"{spent.get(c, 0):8.1f}" for c in COLUMNS) + f"  {name}")
