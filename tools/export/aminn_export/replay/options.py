"""How the C runtime is compiled without CMake."""

from __future__ import annotations

import functools
import re

from aminn_rt.sources import runtime_source


@functools.cache
def own_options() -> tuple[str, ...]:
    """The project's own options of the library, but for warnings and what is for firmware alone."""
    text = (runtime_source() / "cmake" / "options.cmake").read_text()
    lists = re.findall(r"^set\(AMINN_RT_(\w+)[^\n]*\n([^)]*)\)", text, re.MULTILINE)
    return tuple(option for name, options in lists if name != "EMBEDDED" for option in options.split())
