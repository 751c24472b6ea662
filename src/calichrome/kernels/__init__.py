"""Loops over pixels: a C extension, and what numpy needs to do the same.

`native` is None where the package was installed without a compiler; everything works without it.
"""

from types import ModuleType

__all__ = ["native"]

native: ModuleType | None
try:
    from calichrome.kernels import native
except ImportError:  # no compiler at installation, or one that is not GCC or Clang
    native = None
