"""What a bench cannot go on with ends it as a wrong option does: usage, the sentence, exit code 2."""

import argparse
import contextlib
from collections.abc import Iterator

from s2r_protocol.exits import S2RError


@contextlib.contextmanager
def told_by(parser: argparse.ArgumentParser) -> Iterator[None]:
    """End the program with the sentence of what is refused inside, e.g. results of other conditions."""
    try:
        yield
    except S2RError as error:
        parser.error(str(error))
