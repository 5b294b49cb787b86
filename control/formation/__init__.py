"""Formation: template, fitted similarity, size, role assignment and schedule of shapes."""
