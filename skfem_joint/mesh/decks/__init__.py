"""Decks of Abaqus and CalculiX (``.inp``): one strict reader.

`cards` takes a file apart, `keywords` says which cards count, `elements` and `sides` what types of
elements and their faces are, `sets` keeps what cards list, and `abaqus` makes a mesh of it.
"""
