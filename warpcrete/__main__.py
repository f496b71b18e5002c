"""Entry point of `python -m warpcrete`, for systems where the script `warpcrete` is not on the path."""

from .cli import main

if __name__ == "__main__":
    main()
