"""From a search to an answer: what is named, what is off, what is rejected, where, with which probability."""
