"""The window's words in other languages: one .po file a language, which translators edit, and their reader."""
