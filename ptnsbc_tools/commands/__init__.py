"""The commands of `ptnsbc`, a folder for each panel of its help; `ptnsbc_tools.cli` registers them."""
