"""The commands of `ptnsbc`: typed functions whose parameters are arguments and options; `cli.PANELS` lists them."""
