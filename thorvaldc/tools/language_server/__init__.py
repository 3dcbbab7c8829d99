"""A language server: diagnostics, completion and navigation in editors.

The language server speaks the Language Server Protocol on standard input and output.  It reads
files and writes none: changes are answers to the editor, which applies them.

- ``server``: the protocol; analyses in a thread of their own, and the publication of diagnostics.
- ``open_document``: the documents that are open in the editor, with their unsaved texts.
- ``features``: the answers to requests about one document.
"""

from thorvaldc.tool_folders import CommandEntry

COMMANDS = (
    CommandEntry("lsp", "lsp_command:lsp", "Serve editors: diagnostics, completion, navigation."),
)
