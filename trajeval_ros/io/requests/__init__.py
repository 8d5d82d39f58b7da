"""What a user asks for, in words and in files: requests, protocols, transforms, covariances."""
