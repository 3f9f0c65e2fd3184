class Spharm < Formula
  desc "Large-scale spherical-harmonic (SPHARM) models of surfaces"
  homepage "https://docs.rs/spharm"
  # The source archive of the release, where its owner keeps it, and its checksum.
  url "https://example.org/spharm_rs-0.1.0.tar.gz"
  sha256 "0000000000000000000000000000000000000000000000000000000000000000"
  license any_of: ["MIT", "Apache-2.0"]

  depends_on "rust" => :build

  def install
    # Dense operations by faer, which needs no other library.
    system "cargo", "install", *std_cargo_args, "--no-default-features", "--features", "tables"
    generate_completions_from_executable(bin/"spharm", "completions")
    system bin/"spharm", "man", man1
  end

  test do
    system bin/"spharm", "generate", "--subdivisions", "4", "--surface", "surface.ply"
    system bin/"spharm", "fit", "--surface", "surface.ply", "--max-degree", "10", "-o", "surface.spharm.npz"
    assert_path_exists testpath/"surface.spharm.npz"
  end
end
