"""`python -m fynjax`, and the script `fynjax`: the command line."""

import sys

from fynjax._core.errors import MissingExtraError


def main() -> None:
    """Run the command line; where its packages are not installed, say in a line how to get them."""
    try:
        from fynjax.app.cli import main as run
    except ModuleNotFoundError as error:
        if (missing := MissingExtraError.of_app(error)) is None:
            raise
        sys.exit(f"fynjax: error: {missing}")
    run()


if __name__ == "__main__":
    main()
