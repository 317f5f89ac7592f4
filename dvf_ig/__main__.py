"""`python -m dvf_ig` is `dvf-ig`."""

from dvf_ig.cli.main import run

if __name__ == "__main__":
    run()
