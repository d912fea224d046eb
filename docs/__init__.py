"""The pages of this folder, their generators (`docs.make`) and the runner of their commands (`docs.commands`)."""
