"""Image files, one module a format: each says by a file's first bytes whether it can read it.

- ``image_file``: what a format must provide, and the checks they share
- ``opening``: the format of a file, found among these modules and those of other packages
"""
