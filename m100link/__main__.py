"""``python -m m100link``."""

from m100link.apps.cli import main

if __name__ == "__main__":
    main()
