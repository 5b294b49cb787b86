"""The shape to form: template, fitted similarity, size, who takes which place, one shape after another."""
