"""`python -m owm` is the command `owm`."""

from owm.cli import main

main()
