"""`python -m calrig`."""

from calrig.cli.start import main

main()
