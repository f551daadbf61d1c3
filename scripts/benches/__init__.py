"""The measurements of robotd, one module each; `harness` is what they share."""
