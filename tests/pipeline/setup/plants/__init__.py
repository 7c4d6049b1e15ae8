"""Plants' files that `init` has to read, and the score: `python -m tests.pipeline.setup.plants`."""
