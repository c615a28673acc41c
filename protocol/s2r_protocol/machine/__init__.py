"""What this machine is good for: facts read from it, judged, each problem with its fix."""

from s2r_protocol.machine.finding import Finding, Level

__all__ = ["Finding", "Level"]
