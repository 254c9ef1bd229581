"""Recipes: a TOML file of steps and requirements, checked before anything runs, and run to a result and a report.

In the order of a run::

    shipped                 names of the recipes that come with robustlab; loads nothing
    load, schema, steps     the file as a checked object
    paths, folders          the files it reads, the folder it writes
    run, requirements       its steps run, its requirements judged
    starters                a recipe to start from
"""
