"""Lineage: what an artefact came from and what came from it, found from the files of a folder alone.

Every artefact has an id, which is that of its content, and records the ids of its parents.

- `files`: read the id and the parents of one file.
- `search`: join the files of a folder.
- `words`: the lineage as lines of text and as JSON.
"""
