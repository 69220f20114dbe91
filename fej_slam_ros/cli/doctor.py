"""Look for what would spoil an estimate in a bag."""
