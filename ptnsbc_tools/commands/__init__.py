"""One module for each command of `ptnsbc`; `ptnsbc_tools.cli` registers them."""
