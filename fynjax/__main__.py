"""`python -m fynjax`: the command line."""

from fynjax.app.cli import main

if __name__ == "__main__":
    main()
