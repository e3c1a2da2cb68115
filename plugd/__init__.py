"""plugd charges an electric car when the grid is cleanest, over several nights at once."""

__version__ = "0.1.0"
