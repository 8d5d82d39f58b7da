"""Programs that use the package with other software; run from the checkout."""
