"""One declaration for three doors: what Python's functions say of themselves, as commands and as steps of recipes."""
