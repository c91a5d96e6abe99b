"""`python -m fynjax`: the command line."""

from fynjax.cli import main

if __name__ == "__main__":
    main()
