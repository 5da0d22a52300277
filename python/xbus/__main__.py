"""``python -m xbus`` is ``xbus``."""

from xbus.cli import main

if __name__ == "__main__":
    main()
