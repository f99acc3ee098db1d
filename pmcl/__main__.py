"""``python -m pmcl``: the command line of an interpreter whose scripts are not on the path."""

from pmcl.cli import main

if __name__ == "__main__":
    main()
