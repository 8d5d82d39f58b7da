"""Output files of an evaluation: result.json, errors.npz; and requirements on their numbers."""
