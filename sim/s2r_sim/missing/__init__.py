"""Physics left out: one concealed effect per object, and what learning it from recordings is worth."""
