"""What a controller may look like.

controller_laws        packed matrices as functions of named parameters, with gradients
controller_structures  structures that combine, their short forms, and their words
"""
