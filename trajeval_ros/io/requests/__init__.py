"""Reading of the user's settings: options, protocols, transforms, joint covariances, limits."""
