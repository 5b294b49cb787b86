"""Compiled C code of vision: its sources, their build, and the library's typed functions.

- `build` compiles the sources with the system's compiler, or with the `ziglang` package.
- `library` loads the build for this processor and checks the arguments of its functions.
- `search.h` explains the search for quadrilaterals and declares its functions.
"""
