"""The command sets of the document, a module each."""
