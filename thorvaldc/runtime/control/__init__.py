"""Control channel, over which other programs command a running driver.

A program can publish twists and call services of the driver.  Requests and answers are lines of
JSON on a local socket.  The page docs/teleoperation.md describes the control channel.
"""
