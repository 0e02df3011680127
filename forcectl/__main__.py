"""`python -m forcectl`."""

from forcectl.cli import main

if __name__ == "__main__":
    main()
