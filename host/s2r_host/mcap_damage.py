"""What reading a damaged MCAP file raises: errors of the library, of its decompressors and of broken lengths."""

from __future__ import annotations

import struct

from mcap.exceptions import McapError

try:
    from zstandard import ZstdError
except ImportError as error:  # mcap depends on it
    raise ImportError("zstandard is missing; it comes with the package mcap") from error

# LZ4's errors are bare RuntimeErrors. A length whose bits were flipped asks for more memory than there is.
DAMAGED = (McapError, ZstdError, RuntimeError, EOFError, ValueError, OverflowError, MemoryError, struct.error)
