"""`python -m agents.cli` is the command `suturegrasp`."""

from agents.cli.main import main

main()
