"""Run the command line: `python -m zenostat`."""

from zenostat.cli.main import main

if __name__ == "__main__":
    main()
