"""C sources of the renderer, and `library`, the typed functions that Python calls.

`render.h` explains the drawing and declares its functions.
"""
