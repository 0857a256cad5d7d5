# phy124 on a CPU, as an ordinary user; linux/amd64 and linux/arm64 (docs/guide/platforms.md).
FROM python:3.12-slim-bookworm

COPY . /opt/phy124
RUN pip install --no-cache-dir --constraint /opt/phy124/constraints.txt "/opt/phy124[demo,bridge]"

# HOME holds the compiled kernels; anybody may write there, so that --user can be anybody.
ENV HOME=/home/phy124 PHY124_HOST=0.0.0.0 PYTHONDONTWRITEBYTECODE=1
RUN useradd --uid 10001 --home-dir "$HOME" --create-home phy124 && chmod 777 "$HOME"
USER phy124
WORKDIR /work

EXPOSE 7860
CMD ["phy124", "--help"]
