"""What host, executor and stand-in agree on: messages, keys, limits, fault codes, arm descriptions."""
