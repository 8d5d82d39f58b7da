"""What an evaluation writes: result.json, errors.npz, and requirements on them."""
