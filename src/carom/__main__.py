"""`python -m carom` is the command `carom`."""

from carom.cli.main import main

main()
