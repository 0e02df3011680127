"""What a scenario is looked at for before it runs, beside what each of its parts must be by itself."""
