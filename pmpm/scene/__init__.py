"""Floor 2: the validated scene and the particles it starts from. Import from the files; nothing heavy loads here."""
