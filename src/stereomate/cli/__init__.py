"""The command line: one module per command, registered in `stereomate.cli.main`."""
