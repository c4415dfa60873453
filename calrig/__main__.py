"""`python -m calrig`."""

from calrig.cli import main

main()
