"""The files that authors write: read with lines, checked, described as schemas, edited in place."""
