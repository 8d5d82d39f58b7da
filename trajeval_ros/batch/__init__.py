"""Many runs: algorithms x sequences x trials, evaluated side by side and kept on disk."""
