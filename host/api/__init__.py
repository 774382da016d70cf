"""The work of the verbs as functions of files, names and typed values; `import trimtab` offers them.

A verb parses its options, calls one of these functions and prints the result. Modules import the library only
when a function is called, as verbs do.
"""
