"""Examples of lab files."""
