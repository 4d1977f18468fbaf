"""Parts of pages: each drives one panel of widgets and knows the context, but no page and no other stage."""
