"""One file per command: its options and its call.  ``cli/app.py`` lists the commands."""
