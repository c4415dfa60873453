"""`python -m calrig`."""

from calrig.cli.main import main

main()
