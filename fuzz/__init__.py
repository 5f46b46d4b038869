"""A mutation fuzzer for specmap: damaged logs and maps in, and nothing may crash or be lost unsaid.

`python -m fuzz --cases 20000 --seed 7` makes small recordings and a map, damages each copy in its
own way, and runs the program's own functions on it. See docs/reliability.md.
"""
