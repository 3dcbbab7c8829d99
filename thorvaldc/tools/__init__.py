"""Tools beside the core: each folder has its commands, and no tool imports another one.

``thorvaldc.tool_folders`` finds them.  A folder can be deleted, and the rest works as before.
"""
