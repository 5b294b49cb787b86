"""Built-in studies, as TOML."""
