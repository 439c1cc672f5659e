"""``python -m fringedic``: the ``fringedic`` command."""

from fringedic.command.main import main

if __name__ == "__main__":
    main()
