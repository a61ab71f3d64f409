"""The study as one offline set of pages, `results/book/index.html`, made from what is committed."""
