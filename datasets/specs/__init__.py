"""Built-in specs of labelled image sets, one TOML file each."""
