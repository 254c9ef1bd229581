"""Digital controllers: formulas, the norm of the sampled loop between the samples too, direct design."""
