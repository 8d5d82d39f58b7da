"""Output for Rerun's viewer. Only this subpackage imports `rerun`."""
