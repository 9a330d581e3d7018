"""The runtime as a Conan package.

conan create packaging/conan [-o "aminn_rt/*:hand=PATH"] [-o "aminn_rt/*:max_width=64"]
"""

import re
from pathlib import Path
from typing import ClassVar

from conan import ConanFile
from conan.tools.cmake import CMake, CMakeToolchain, cmake_layout
from conan.tools.files import copy, load


class AminnRt(ConanFile):
    """Built by the tree's own CMake files; its users get the same CMake target as from an installed library."""

    name = "aminn_rt"
    description = "Grasp stability and in-hand displacement at control rate, no heap"
    license = "Apache-2.0"
    package_type = "static-library"
    settings = "os", "arch", "compiler", "build_type"
    options: ClassVar = {"hand": ["", "ANY"], "max_width": ["", "ANY"]}
    default_options: ClassVar = {"hand": "", "max_width": ""}

    def set_version(self):
        header = load(self, Path(self.recipe_folder) / "../../runtime/include/aminn_rt.h")
        self.version = re.search(r'#define AMINN_VERSION_STRING "([^"]+)"', header)[1]

    def export_sources(self):
        tree = Path(self.recipe_folder) / "../.."
        copy(self, "runtime/*", tree, self.export_sources_folder)
        copy(self, "LICENSE", tree, self.export_sources_folder)

    def layout(self):
        cmake_layout(self, src_folder="runtime")

    def generate(self):
        toolchain = CMakeToolchain(self)
        toolchain.cache_variables["AMINN_HAND"] = str(self.options.hand)
        toolchain.cache_variables["AMINN_MAX_WIDTH"] = str(self.options.max_width)
        toolchain.generate()

    def build(self):
        cmake = CMake(self)
        cmake.configure()
        cmake.build()

    def package(self):
        CMake(self).install()
        copy(self, "LICENSE", Path(self.source_folder).parent, Path(self.package_folder) / "licenses")

    def package_info(self):
        self.cpp_info.set_property("cmake_find_mode", "none")  # the library installs its own CMake package
        self.cpp_info.builddirs = ["lib/cmake/aminn_rt"]
        self.cpp_info.libs = ["aminn_rt"]
        if self.settings.os == "Linux":
            self.cpp_info.system_libs = ["m"]
        if self.options.max_width:
            self.cpp_info.defines = [f"AMINN_MAX_WIDTH={self.options.max_width}"]
