"""Studies over many sealed worlds. The command line finds them in the entry-point group `trimtab.studies`.

They run the host through its command line. Only `scoring` opens the truth of a world, and only after the
verdict has been written.
"""
