"""`python -m owm_envs` is the command `owm-envs`."""

from owm_envs.shell import end_when_interrupted


def main() -> None:
    """Run the command, which a Ctrl-C ends in one line from here on."""
    end_when_interrupted()
    from owm_envs.cli import main

    main()


if __name__ == "__main__":
    main()
