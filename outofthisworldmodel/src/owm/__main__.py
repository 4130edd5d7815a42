"""`python -m owm` is the command `owm`."""

import os
import signal


def main() -> None:
    """Run the command, which a Ctrl-C ends in one line from here on."""
    # Before the first import that takes time; `owm_envs.shell` goes on from there.
    signal.signal(signal.SIGINT, lambda *_: (os.write(2, b"interrupted\n"), os._exit(130)))
    from owm.cli import main

    main()


if __name__ == "__main__":
    main()
