"""What a lab can measure of its pushes: one documented table, its files, its checks, and what stands in for sensors."""

from .checks import Fault, TableError, check
from .columns import Column, columns_of
from .fallbacks import complete
from .files import FORMATS, format_of
from .mapping import Map, read_map
from .read import read_table
from .write import template, write_table

__all__ = [
    "FORMATS",
    "Column",
    "Fault",
    "Map",
    "TableError",
    "check",
    "columns_of",
    "complete",
    "format_of",
    "read_map",
    "read_table",
    "template",
    "write_table",
]
