"""The operator's console: a web page that shows one arm and can stop it; a pure Zenoh client."""
