"""What all folders stand on, and what knows nothing of mechanics but the loads.

`errors` are those that users see, `values` and `arrays` check numbers and types of arrays, `loads`
are forces over time. Files: `files` writes them whole or not at all, `array_files` reads and writes
arrays, of some formats in a process of its own, `plain_values` dataclasses with arrays, and makes
tables of pandas, `text_tables` reads tables of text, `rows` keeps finished work from which a
command goes on, `key_paths` are keys of tables as one text. `compiling` compiles loops; `progress`,
`terminal` and `processes` are the command's.
"""
