"""What the commands do, a module a kind. Heavy imports wait inside them, so that `--help` is quick."""
