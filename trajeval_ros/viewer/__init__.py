"""What is shown in Rerun: the only room that imports `rerun`."""
