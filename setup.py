"""Builds the C kernels where there is a compiler; without one the package works all the same."""

from setuptools import Extension, setup

_FOLDER = "src/calichrome/kernels"

setup(
    ext_modules=[
        Extension(
            "calichrome.kernels.native",
            [f"{_FOLDER}/native.c"],
            depends=[f"{_FOLDER}/{name}" for name in ("plan.h", "correct.h", "yuv.h", "lanes.h")],
            # roots become single instructions once they need not report errors; vectors are never
            # passed between functions, as all are inlined
            extra_compile_args=["-O3", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi"],
            py_limited_api=True,
            optional=True,
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
