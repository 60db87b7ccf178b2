"""`python -m pipeline` is `nightglass`."""

from pipeline.cli import main

main()
