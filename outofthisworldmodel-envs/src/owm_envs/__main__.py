"""`python -m owm_envs` is the command `owm-envs`."""

from owm_envs.cli import main

main()
