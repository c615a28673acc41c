"""``python -m s2r_protocol`` is ``s2r``: how one process of the project starts another."""

from s2r_protocol.cli.root import main

main()
