"""What is shown in Rerun: the only subpackage that imports `rerun`."""
