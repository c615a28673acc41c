"""A target that is asked for once the joint is known: whoever sees the model can tell how far the part may go."""

from __future__ import annotations

import sys

from s2r_host.run.record import RunRecord
from s2r_protocol.exits import UsageError


def ask_operator(record: RunRecord) -> float:
    """Read the target from standard input; what is no target is refused and, on a terminal, asked for again.

    Args:
        record: With the belief, the joint value found and the view that targets count from.

    Returns:
        As ``--target`` is counted [m or rad].

    Raises:
        UsageError: Standard input has ended, or is no terminal and has no target.
    """
    task, say = record.settings.task, record.journal.say
    assert record.belief is not None
    assert record.s_found is not None
    low, high = (record.show(limit, 0) for limit in record.belief.model.range)
    origin = "from here" if record.settings.from_pushed else "from as found in the first view"
    say(
        f"{task.part} at {record.show(record.s_found)}, believed to go from {low} to {high}; "
        f"+ is {task.positive}"
    )
    while True:
        say(f"target, counted {origin}:")
        line = sys.stdin.readline()
        if not line:
            raise UsageError("--target ask: standard input ended without a target; nothing more was moved")
        try:
            return task.targets.read(line.strip())
        except UsageError as error:
            if not sys.stdin.isatty():
                raise
            say(str(error))
