"""Serves a page that shows a robot while its file is edited."""
