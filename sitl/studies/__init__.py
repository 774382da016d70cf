"""Studies over many sealed worlds. The command line finds them in the entry-point group `trimtab.studies`.

They run the host as anybody does, through its command line; what a world holds is opened by `scoring` alone,
and only when the verdict on it is a file.
"""
