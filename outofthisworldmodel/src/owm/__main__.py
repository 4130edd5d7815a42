"""`python -m owm` is the command `owm`."""

from owm_envs.shell import end_when_interrupted


def main() -> None:
    """Run the command, which a Ctrl-C ends in one line from here on."""
    end_when_interrupted()
    from owm.cli import main

    main()


if __name__ == "__main__":
    main()
