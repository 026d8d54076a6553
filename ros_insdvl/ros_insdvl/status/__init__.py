"""What the nodes say of themselves in /diagnostics: one module per cause."""
