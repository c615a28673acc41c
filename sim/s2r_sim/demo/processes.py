"""The demo's processes; starting and ending them is shared with replay and tests."""

from s2r_protocol.cli.peers import PeerFailedError, free_port, peer, s2r_command, with_parent

__all__ = ["PeerFailedError", "free_port", "peer", "s2r_command", "with_parent"]
