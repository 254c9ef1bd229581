"""Digital controllers: formulas, the sampled loop's exact norm, robustness between the samples too."""
