"""The 3D viewer in a web browser: the page of ``thorvaldc view`` and the data that it draws.

The JavaScript is built from the folder ``viewer/``.  The room takes the surfaces of shapes from
``pictures``, and no physics.  Begin with ``view_page``, or with ``viewer_data`` for the JSON object
that the preview sends after each change of a file.
"""
