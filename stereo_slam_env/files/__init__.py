"""Files that are read and written: bounded readers, atomic writes, locked folders."""
