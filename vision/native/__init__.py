"""C sources of vision, and `library`, the typed functions that Python calls.

`search.h` explains the search for quadrilaterals and declares its functions.
"""
