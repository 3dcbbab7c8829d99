"""Control channel, over which other programs command a running driver.

Another program can publish commanded twists and call services of the base driver.  Requests and
answers of the control channel are lines of JSON on a local socket.  The page docs/teleoperation.md
describes the control channel.
"""
