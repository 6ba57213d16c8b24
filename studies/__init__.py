"""Studies written with the public interface, run from a checkout; they are no part of the installed package."""
