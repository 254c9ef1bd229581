"""Recipes: a TOML file of steps and requirements, checked before anything runs, and run to a result and a report.

In the order of a run::

    shipped                 names of the recipes that come with robustlab; loads nothing
    load, schema, steps     the file as a checked object, and the files it reads
    check                   what is wrong with it that can be told before the first step
    run                     its steps run, its requirements judged, the folder it writes
    starters                a recipe to start from
"""
