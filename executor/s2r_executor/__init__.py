"""The executor's front end: admission, lease, recorder and the link to the native real-time core."""
