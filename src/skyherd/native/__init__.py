"""Build and loading of the compiled C libraries.

Sources are in a folder `native` of the package that uses them, such as `vision/native`, beside a module
`library.py` with typed functions.

- `build` compiles the sources with the system's compiler, or with the `ziglang` package.
- `loading` loads the build for this processor and checks its version.
- `library.c` has the functions that every library has.
"""
