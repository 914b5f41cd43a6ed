"""The pages and the API reference: their links, their examples, and the site made of them."""
