"""How parameters are declared, checked and read from files."""
