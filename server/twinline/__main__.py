"""``python -m twinline``."""

from twinline.cli import main

if __name__ == "__main__":
    main()
