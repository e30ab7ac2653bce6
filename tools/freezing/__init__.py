"""What `tools/freeze.py` freezes and how it compares.

inputs    robot files, shows, fault plans and foreign files that the cases use
cases     which commands are run on which inputs
capture   runs a command in process and returns what it did, without facts of the wall clock
folders   writes the results to a folder, and compares two such folders
"""
